.class Ldressi/sample/MainActivity$7;
.super Ljava/lang/Object;

# interfaces
.implements Ljava/lang/Runnable;


# annotations
.annotation system Ldalvik/annotation/EnclosingMethod;
    value = Ldressi/sample/MainActivity;->onProgress(Ldressi/sample/Worker;Landroid/graphics/Bitmap;Landroid/graphics/Bitmap;FLjava/lang/String;)V
.end annotation

.annotation system Ldalvik/annotation/InnerClass;
    accessFlags = 0x0
    name = null
.end annotation


# instance fields
.field final synthetic this$0:Ldressi/sample/MainActivity;

.field final synthetic val$from:Ldressi/sample/Worker;

.field final synthetic val$loss:F

.field final synthetic val$now:Landroid/graphics/Bitmap;

.field final synthetic val$text:Ljava/lang/String;

.field final synthetic val$wanted:Landroid/graphics/Bitmap;


# direct methods
.method constructor <init>(Ldressi/sample/MainActivity;Ldressi/sample/Worker;Landroid/graphics/Bitmap;Landroid/graphics/Bitmap;FLjava/lang/String;)V
    .registers 7
    .annotation system Ldalvik/annotation/Signature;
        value = {
            "()V"
        }
    .end annotation

    iput-object p1, p0, Ldressi/sample/MainActivity$7;->this$0:Ldressi/sample/MainActivity;

    iput-object p2, p0, Ldressi/sample/MainActivity$7;->val$from:Ldressi/sample/Worker;

    iput-object p3, p0, Ldressi/sample/MainActivity$7;->val$wanted:Landroid/graphics/Bitmap;

    iput-object p4, p0, Ldressi/sample/MainActivity$7;->val$now:Landroid/graphics/Bitmap;

    iput p5, p0, Ldressi/sample/MainActivity$7;->val$loss:F

    iput-object p6, p0, Ldressi/sample/MainActivity$7;->val$text:Ljava/lang/String;

    invoke-direct {p0}, Ljava/lang/Object;-><init>()V

    return-void
.end method


# virtual methods
.method public run()V
    .registers 3

    iget-object v0, p0, Ldressi/sample/MainActivity$7;->val$from:Ldressi/sample/Worker;

    iget-object v1, p0, Ldressi/sample/MainActivity$7;->this$0:Ldressi/sample/MainActivity;

    # getter for: Ldressi/sample/MainActivity;->worker:Ldressi/sample/Worker;
    invoke-static {v1}, Ldressi/sample/MainActivity;->access$100(Ldressi/sample/MainActivity;)Ldressi/sample/Worker;

    move-result-object v1

    if-eq v0, v1, :cond_b

    :goto_a
    return-void

    :cond_b
    iget-object v0, p0, Ldressi/sample/MainActivity$7;->val$wanted:Landroid/graphics/Bitmap;

    if-eqz v0, :cond_1a

    iget-object v0, p0, Ldressi/sample/MainActivity$7;->this$0:Ldressi/sample/MainActivity;

    # getter for: Ldressi/sample/MainActivity;->target:Landroid/widget/ImageView;
    invoke-static {v0}, Ldressi/sample/MainActivity;->access$500(Ldressi/sample/MainActivity;)Landroid/widget/ImageView;

    move-result-object v0

    iget-object v1, p0, Ldressi/sample/MainActivity$7;->val$wanted:Landroid/graphics/Bitmap;

    invoke-virtual {v0, v1}, Landroid/widget/ImageView;->setImageBitmap(Landroid/graphics/Bitmap;)V

    :cond_1a
    iget-object v0, p0, Ldressi/sample/MainActivity$7;->val$now:Landroid/graphics/Bitmap;

    if-eqz v0, :cond_29

    iget-object v0, p0, Ldressi/sample/MainActivity$7;->this$0:Ldressi/sample/MainActivity;

    # getter for: Ldressi/sample/MainActivity;->picture:Landroid/widget/ImageView;
    invoke-static {v0}, Ldressi/sample/MainActivity;->access$600(Ldressi/sample/MainActivity;)Landroid/widget/ImageView;

    move-result-object v0

    iget-object v1, p0, Ldressi/sample/MainActivity$7;->val$now:Landroid/graphics/Bitmap;

    invoke-virtual {v0, v1}, Landroid/widget/ImageView;->setImageBitmap(Landroid/graphics/Bitmap;)V

    :cond_29
    iget v0, p0, Ldressi/sample/MainActivity$7;->val$loss:F

    iget v1, p0, Ldressi/sample/MainActivity$7;->val$loss:F

    cmpl-float v0, v0, v1

    if-nez v0, :cond_3c

    iget-object v0, p0, Ldressi/sample/MainActivity$7;->this$0:Ldressi/sample/MainActivity;

    # getter for: Ldressi/sample/MainActivity;->curve:Ldressi/sample/CurveView;
    invoke-static {v0}, Ldressi/sample/MainActivity;->access$700(Ldressi/sample/MainActivity;)Ldressi/sample/CurveView;

    move-result-object v0

    iget v1, p0, Ldressi/sample/MainActivity$7;->val$loss:F

    invoke-virtual {v0, v1}, Ldressi/sample/CurveView;->add(F)V

    :cond_3c
    iget-object v0, p0, Ldressi/sample/MainActivity$7;->this$0:Ldressi/sample/MainActivity;

    # getter for: Ldressi/sample/MainActivity;->status:Landroid/widget/TextView;
    invoke-static {v0}, Ldressi/sample/MainActivity;->access$800(Ldressi/sample/MainActivity;)Landroid/widget/TextView;

    move-result-object v0

    iget-object v1, p0, Ldressi/sample/MainActivity$7;->val$text:Ljava/lang/String;

    invoke-virtual {v0, v1}, Landroid/widget/TextView;->setText(Ljava/lang/CharSequence;)V

    goto :goto_a
.end method
