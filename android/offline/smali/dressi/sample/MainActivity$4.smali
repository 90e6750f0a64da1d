.class Ldressi/sample/MainActivity$4;
.super Ljava/lang/Object;

# interfaces
.implements Landroid/view/View$OnClickListener;


# annotations
.annotation system Ldalvik/annotation/EnclosingMethod;
    value = Ldressi/sample/MainActivity;->onCreate(Landroid/os/Bundle;)V
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

    iput-object p1, p0, Ldressi/sample/MainActivity$4;->this$0:Ldressi/sample/MainActivity;

    invoke-direct {p0}, Ljava/lang/Object;-><init>()V

    return-void
.end method


# virtual methods
.method public onClick(Landroid/view/View;)V
    .registers 3

    iget-object v0, p0, Ldressi/sample/MainActivity$4;->this$0:Ldressi/sample/MainActivity;

    # invokes: Ldressi/sample/MainActivity;->capture()V
    invoke-static {v0}, Ldressi/sample/MainActivity;->access$300(Ldressi/sample/MainActivity;)V

    return-void
.end method
