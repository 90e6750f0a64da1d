.class Ldressi/sample/MainActivity$5;
.super Ljava/lang/Object;

# interfaces
.implements Landroid/widget/AdapterView$OnItemSelectedListener;


# annotations
.annotation system Ldalvik/annotation/EnclosingMethod;
    value = Ldressi/sample/MainActivity;->onStart()V
.end annotation

.annotation system Ldalvik/annotation/InnerClass;
    accessFlags = 0x0
    name = null
.end annotation


# instance fields
.field final synthetic this$0:Ldressi/sample/MainActivity;


# direct methods
.method constructor <init>(Ldressi/sample/MainActivity;)V
    .registers 2

    iput-object p1, p0, Ldressi/sample/MainActivity$5;->this$0:Ldressi/sample/MainActivity;

    invoke-direct {p0}, Ljava/lang/Object;-><init>()V

    return-void
.end method


# virtual methods
.method public onItemSelected(Landroid/widget/AdapterView;Landroid/view/View;IJ)V
    .registers 8
    .annotation system Ldalvik/annotation/Signature;
        value = {
            "(",
            "Landroid/widget/AdapterView",
            "<*>;",
            "Landroid/view/View;",
            "IJ)V"
        }
    .end annotation

    iget-object v0, p0, Ldressi/sample/MainActivity$5;->this$0:Ldressi/sample/MainActivity;

    const/4 v1, 0x0

    # invokes: Ldressi/sample/MainActivity;->restart(Z)V
    invoke-static {v0, v1}, Ldressi/sample/MainActivity;->access$200(Ldressi/sample/MainActivity;Z)V

    return-void
.end method

.method public onNothingSelected(Landroid/widget/AdapterView;)V
    .registers 2
    .annotation system Ldalvik/annotation/Signature;
        value = {
            "(",
            "Landroid/widget/AdapterView",
            "<*>;)V"
        }
    .end annotation

    return-void
.end method
